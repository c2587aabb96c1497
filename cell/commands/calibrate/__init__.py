"""The commands `foldcell calibrate ...`. `calibration` has the procedures, `cell.calibrating` performs them."""
