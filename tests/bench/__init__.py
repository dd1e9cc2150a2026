"""Figures of speed and memory: `make bench`. Printed, never asserted: machines are noisy."""
