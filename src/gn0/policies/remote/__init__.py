"""Policies in another process: wire format, client, policy, and a small server kit.

The wire is the released GN-Bench evaluation protocol (WebSocket + msgpack), byte for byte, with one
optional extension of ours that a peer without it never sees.
"""
