"""Bytes that nobody should write, given to everything that reads values of the bus."""
