"""From episodes to files for training and for a quick look: what all formats share; the formats are adapters."""
