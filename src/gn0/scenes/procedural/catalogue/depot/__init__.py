"""Things of store rooms and warehouses: racks, pallets, cartons, trucks, docks, safety gear."""
