"""Corruptions of episodes, written from outside: what does ``station check`` say of each? `tests.corruption.bench`."""
