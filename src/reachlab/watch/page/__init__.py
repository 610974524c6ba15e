"""A page in which a policy itself runs: scripts for the browser, and what is put into them."""
