"""GN-BAE: a vision-language policy; its prompts and tokens need no torch."""
