"""What an operator does, whatever the device: samples and their freshness, dead-man, buttons, and what comes of it."""
