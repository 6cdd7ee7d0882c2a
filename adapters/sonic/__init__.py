"""GEAR-SONIC, over ZeroMQ: its packed messages, its planner's commands as velocities, its streamed poses as motions.

=========  ============================================================================================================
`message`  a message as a topic, a header of JSON and the raw numbers of its fields
`planner`  the topics ``command`` and ``planner``, and velocities of a robot on legs both ways
`pose`     the topic ``pose`` in version 1, and TWIST2's whole-body command both ways
=========  ============================================================================================================

Facts: NVlabs/GR00T-WholeBodyControl, its page on streaming over ZeroMQ, ``zmq_planner_sender.py`` and
``zmq_manager.hpp``. Its builders are an independent peer in the tests.
"""
