"""A motion controller of another make, added from outside the product: its protocol, driver and twin device are here."""
