"""The results page of a campaign."""
