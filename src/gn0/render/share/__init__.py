"""One process owns the device and draws for many: the others ask it and get shared memory."""
