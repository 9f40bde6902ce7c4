"""Entry points: code of others that an installed package adds, each kind in a group of its own."""
