"""A module that takes address space, as VTK does."""

import mmap

SPACE = mmap.mmap(-1, 10**9)
