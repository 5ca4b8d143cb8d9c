"""Motion-capture servers in software: each speaks its maker's documented wire format, fed by whatever moves here."""
