"""What makes a recording readable for others: typed siblings of its keys, in a file of their own beside it."""
