"""Statistics of campaigns: proportions, paired comparisons, tables."""
