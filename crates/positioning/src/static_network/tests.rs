//! Networks small enough to be enumerated, flips that the network resolves, and the same bits on any thread.
