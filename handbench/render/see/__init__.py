"""What is seen from where: rays, rasters, hard and soft shadows."""
