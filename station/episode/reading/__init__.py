"""How an episode is read: streams, messages, vectors, pictures, policy steps."""
