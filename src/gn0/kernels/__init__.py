"""Compiled kernels: what each depends on, and which ones jobs call, to compile them ahead."""
