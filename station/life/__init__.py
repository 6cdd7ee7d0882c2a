"""How a process lives, and how a station starts."""
