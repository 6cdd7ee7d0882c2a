"""What the pictures of an episode are called, in its folder."""

CONTACT_SHEET = "contact-sheet.png"
PLOT = "plot.png"
RERUN = "episode.rrd"
