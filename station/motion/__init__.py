"""A motion as commands: played, paused, sought."""
