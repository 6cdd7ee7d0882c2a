"""One module per verb: parse and print; the work is elsewhere."""
