"""Seeds of what is drawn at random: each part of a frame has random numbers of its own."""

import zlib

LARGEST_SEED = 2**63 - 1


def part_seed(seed: int, *parts: int | str) -> int:
    """Seed of a named or numbered part of what a seed makes: each has random numbers of its own."""
    import numpy as np

    words = (zlib.crc32(part.encode()) if isinstance(part, str) else part for part in parts)
    high, low = np.random.SeedSequence([seed, *words]).generate_state(2, np.uint32).tolist()
    return int(high >> 1) << 32 | int(low)
