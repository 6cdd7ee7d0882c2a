"""How a station and an episode are looked at."""
