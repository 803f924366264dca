"""What the build of a mechanism of continuum bodies takes over unknowns and ranks: `scripts/bench_scaling`."""
