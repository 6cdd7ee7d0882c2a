"""Devices that are not there: each one stands in at the lowest layer, under the real library, and plays a script."""
