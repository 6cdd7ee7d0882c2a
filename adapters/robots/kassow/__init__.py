"""Seven-axis arms of Kassow Robots, behind a controller of their own."""
