"""Running calibration procedures (calibration/) with a cell: the same checks, stop and journal as a fold."""
