"""The ladder to a robot: ordered steps from nothing that moves to a fold that is stopped and resumed."""
