"""How accurate a cloud is, and whether its predicted sigmas say so."""
