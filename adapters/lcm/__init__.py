"""LCM, which HOMIE's and walk-these-ways' programs speak: its messages, its packets, its socket.

===========  ==========================================================================================================
`message`    a type as a table: its fingerprint, and its values as bytes
`types`      the types of HOMIE and of walk-these-ways
`packet`     messages as datagrams: short ones, and fragments of long ones
`multicast`  the socket
===========  ==========================================================================================================

No library is needed. LCM's own, which is an independent peer in the tests, reads and writes the same bytes.
"""
