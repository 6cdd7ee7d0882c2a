"""How an episode's file is written, told again from what is whole of it, and repaired."""
