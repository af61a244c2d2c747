"""Section 5 of Beermann et al. 2018 remade: every curve and every statement, beside the paper's."""
