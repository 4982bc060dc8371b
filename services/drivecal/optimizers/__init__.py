"""Optimizers as pure ask/tell over grid indices: no I/O, an explicit generator, and a state that serialises at any moment."""
