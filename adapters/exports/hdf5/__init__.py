"""HDF5 as robomimic and ALOHA's ACT read it, of the rows that a LeRobot data set has."""
