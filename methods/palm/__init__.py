"""PALM-Net: an implicit, physically based hand prior of many subjects, personalised from one picture."""
