"""Spacemice of 3Dconnexion."""
