"""Human motion: readers of what people have, retargeting to our body, cycles of a walk."""
