"""From a person's body to a humanoid's: layers that can be looked at, and exchanged, one by one.

=================  ====================================================================================================
`human`            a person's proportions, and 24 joints put together from how the bones point
`skeleton`         the person who does what a G1 does: what retargeting is judged by, and what the fakes play
`calibration`      what is known of an operator: lengths, floor, how the device's frames sit on the bones
`smoothing`        a filter of known latency over what the device says
`scaling`          the operator's posture, in the robot's size
`contact`          which foot carries; where it is held
`body_ik`          joints of the robot from that posture, clear of itself (`ik_tasks`, `weights`)
`arm_rescue`       leads an arm back that is caught behind the end of a joint's range
`derivatives`      velocities of the root from the device's own times
`anchor`           where the operator's world lies in the robot's; tracking that jumps moves no robot
`pipeline`         all of them, a body in, a `station.protocols.Reference` out
`skeleton_file`    a person's motion as a file; `played` makes a motion of the robot of it
`evaluate`         ``python -m adapters.retarget.evaluate``: how well a clip comes back
=================  ====================================================================================================

Everywhere: metres, radians, seconds; x forward, y left, z up; quaternions ``w x y z``. The **rest frame** of a bone is
that of the world when the person stands in a T-pose (arms out, palms down) and looks along x.
"""
