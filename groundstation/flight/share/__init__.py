"""A station and its views on other machines: certificates, the gate between network and core, its clients, cameras
elsewhere.
"""
