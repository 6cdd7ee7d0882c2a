"""What an operator does, whatever the device: readings, their freshness, and the loop that device servers share."""
