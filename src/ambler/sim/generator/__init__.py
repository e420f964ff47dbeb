"""A generator of buildings: offices, flats, wards, warehouses, halls, corridors, yards and campuses, another one for every seed.

What it draws is the content of a world file (`sim.world_file`), so that people can read and change it. The way there: zones (rooms,
corridors) tile an outline, walls stand where zones meet, doors connect them, furniture is put into rooms as people put it, and a flood
fill proves that a robot can get everywhere (`generator.floor`).
"""
