"""Files of results and of work on the way: written whole or not at all, sealed, owned by one job, taken up again.

`hdf5` writes and opens results, `seal` says whether a file is whole, `claims` keeps jobs apart,
`checkpoint_folder` holds what is finished of a longer job. Begin with `hdf5`.
"""
