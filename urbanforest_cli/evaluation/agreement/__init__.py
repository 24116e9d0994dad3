"""How well planted crowns cover what a coverage map covers, lot by lot."""
