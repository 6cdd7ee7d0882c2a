"""Live motion capture by OptiTrack's Motive, which streams by NatNet over UDP: a person's skeleton as a body.

===========  ==========================================================================================================
`wire`       messages, byte for byte; what comes is checked against its bounds, whoever sent it
`actor`      from the bones of one of Motive's skeletons to the 24 joints of a body in our world
`device`     the connection, and what of it is fresh
`kind`       settings, and what the command line shows
===========  ==========================================================================================================

No library is needed. Nothing of it was tried with Motive: a fake speaks the same bytes, which a client of others reads.
"""
