"""Many flights: the catalogue of a logs folder, trends over flights, batch work on one machine or a cluster."""
