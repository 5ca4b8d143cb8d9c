"""Widgets that several screens of the terminal UI share."""
