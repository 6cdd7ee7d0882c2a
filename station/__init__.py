"""Teleop Station: what every process of a station shares."""
