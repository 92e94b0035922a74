"""`handbench geometry`: the geometry autoencoder trained and scored on its own, beside two baselines."""
