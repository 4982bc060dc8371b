"""A chosen set as a file: its review sheet and its calibration file, from the functions behind the other answers."""
