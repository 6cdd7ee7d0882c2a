"""Whole-body command vectors as they stand on the bus."""
