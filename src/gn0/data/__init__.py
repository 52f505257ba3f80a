"""GN-Matrix samples: poses, labels and hashes; pictures are a cache of them."""
