"""Two UR5 arms with parallel grippers, and a camera on a mast between them. The cell exists only in simulation."""
