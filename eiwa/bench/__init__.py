"""How fast eiwa is on this machine, beside what it could be and what else there is."""
