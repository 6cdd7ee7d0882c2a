"""Motion capture of people, read from files: from what a format holds to one person in our world.

==================  ===================================================================================================
`bvh_file`          the format BVH: a tree of joints, and how each turns in each frame
`bvh`               from its joints to those of a body
`skeleton_tree`     which joints of a tree are which of a body, by the names that capture systems give them
`amass`             AMASS and SMPL-X: joint rotations of a body model, put onto a skeleton of ours
`c3d_markers`       C3D: markers, by the library ``c3d``
`plug_in_gait`      from the markers of Plug-in Gait to joints
`joints`            what a reader returns, before anything is known of its world
`captured`          that, with x forward, y left, z up and the floor at 0 [m]: a person who can be retargeted
==================  ===================================================================================================

A reader never runs what a file says, and allocates by what the file really has.
"""
