"""An HTML report of episodes: one file that a person wants to look at, with every picture in it and no script."""
