"""The page on which a person places the key points of a garment in its picture."""
