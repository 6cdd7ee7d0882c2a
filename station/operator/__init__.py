"""What an operator does, whatever the device: readings, their freshness, dead-man, buttons, and the loops' parts."""
