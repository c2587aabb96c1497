"""What the program is measured with, beside its peers: `foldcell bench NAME`, and the pictures of the docs."""
