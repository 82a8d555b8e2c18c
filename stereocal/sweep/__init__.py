"""Parameter sweeps: the paper's section 3, on any executor, resumable.

===================  ==========================================================================================
``disparity_sweep``  :func:`sweep_disparity`: the grid of window sizes and speckle sizes
``blocks``           one window size with all speckle sizes: the unit of work
``table``            the table of results, and the CSV file that outlives a kill
``executors``        executors by name: ``local``, ``dask:ADDRESS``
===================  ==========================================================================================
"""
