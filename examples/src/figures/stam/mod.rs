//! [Stam 2020], Computing light transport gradients using the adjoint method.
