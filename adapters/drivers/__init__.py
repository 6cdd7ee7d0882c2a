"""From an operator's input to commands: of a G1 by hands, sticks, twists, leader joints or the whole body; of an arm by
its joints or its tool."""
