"""LCM, which HOMIE's and walk-these-ways' programs speak: its messages, its packets, its socket, HOMIE's channels.

===========  ==========================================================================================================
`message`    a type as a table: its fingerprint, and its values as bytes
`types`      the types of HOMIE and of walk-these-ways
`packet`     messages as datagrams: short ones, and fragments of long ones
`multicast`  the socket
`homie`      which channel of HOMIE's is which part of a G1's command
===========  ==========================================================================================================

No library is needed. LCM's own, which is an independent peer in the tests, reads and writes the same bytes.
"""
