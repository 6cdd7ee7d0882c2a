"""What is measured of an episode, and how it is judged."""
