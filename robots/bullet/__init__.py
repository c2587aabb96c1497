"""A robot's body in PyBullet, described by its URDF."""
