"""A server's life, and what every one of them shares: its loop, events, requests, the emergency stop."""
