"""The page: a swarm from above in a browser, of live nodes, a plan or a recording; what it shows is plain data from one model."""
