"""This program beside Naets, Tamarozzi and Desmet (2015): `python -m benchmarks.paper.summary results/`."""
