"""Cameras: what a source of pictures is, and the loop that brings its pictures to the bus. Knows no source."""
