"""Lidars: what a source of point clouds is, and what goes to the bus of them. Knows no source."""
