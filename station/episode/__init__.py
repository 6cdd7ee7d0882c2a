"""What remains: episodes on disk."""
