"""The history of a logs folder as pages: its runs and campaigns, and two runs side by side."""
