"""Tables and what is as low: desks, nightstands, television stands, rugs, televisions."""
