"""The recorder without its process: the tap's writes in, episodes, answers and events out."""
