"""The report's sections: each takes the page and what it shows, and adds itself."""
