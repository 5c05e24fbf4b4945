"""What the module receives by the light on the cube: counted day by day, and what another law would have made of it."""
