"""Camera pictures with the plan, or with what was expected, drawn on them."""
