"""Search for neighbours on device arrays: hash grid and kd-tree."""
