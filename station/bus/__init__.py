"""How anything is said: keys, contracts, stamps, and the Redis server that carries them."""
