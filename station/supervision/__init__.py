"""Bringing a station up and looking after it: runbooks, checks, child processes, what to do when one dies."""
