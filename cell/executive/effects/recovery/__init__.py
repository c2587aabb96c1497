"""Effects after a failure: choose what to try, free, lay down or let go of cloth, park, estimate and repair."""
