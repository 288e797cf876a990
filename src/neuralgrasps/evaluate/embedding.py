"""Two-dimensional pictures of codes by Barnes-Hut t-SNE."""

from __future__ import annotations

import numpy as np

from neuralgrasps.errors import InputError, check_shape


def embed_codes(codes: np.ndarray, *, seed: int, perplexity: float = 30.0) -> np.ndarray:
    """Place codes in the plane so that near codes are near.

    Args:
        codes: (N, D), N >= 5; compared by Manhattan distance, like retrieval does.
        seed: of the start; perplexity: about how many neighbours count, lowered to (N - 1) / 3 for few codes.
    Returns:
        (N, 2) float64.
    Source:
        van der Maaten 2014, "Accelerating t-SNE using tree-based algorithms"; scikit-learn.
    """
    from sklearn.manifold import TSNE  # noqa: PLC0415 - slow to import

    check_shape("codes", np.shape(codes), (None, None))
    if len(codes) < 5:
        raise InputError(f"{len(codes)} codes were given; a picture needs at least 5.")
    method = TSNE(
        perplexity=min(perplexity, (len(codes) - 1) / 3.0), metric="manhattan", init="pca", random_state=seed % 2**32
    )
    return method.fit_transform(np.asarray(codes, np.float32)).astype(np.float64)
