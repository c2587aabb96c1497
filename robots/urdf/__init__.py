"""A robot that one URDF describes: from the file to the values of a `Robot`."""
