"""The pictures of a finished episode made into video."""
