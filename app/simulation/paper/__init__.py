"""The paper's tables and figures beside ours: Table 3, the Gaussian in the plane of incidence, the worst corner."""
