"""Running calibration procedures (calibration/) with a cell: the same checks, stop and ledger as a fold."""
