"""A metric: a `Family` says what is measured and what its signature must tell; regions, spaces and scales come free."""

import numpy as np

from handbench.metrics import Family, View


def mae(view: View) -> float:
    """Mean absolute error of the pixels and channels that count."""
    return float(np.mean(np.abs(view.prediction - view.truth)[view.support]))


MAE = Family("example-mae", "MAE", mae, higher_is_better=False, decimals=4)
