"""Files from a rig: columns of numbers, read without ever misreading one."""
