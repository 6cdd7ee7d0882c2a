"""Every write of the bus, in order and byte for byte."""
