"""What a notebook or a script uses of the station; ``import station`` offers it by name."""
