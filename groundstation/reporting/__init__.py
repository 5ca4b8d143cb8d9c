"""Reports, figures and exports of identified flights; importing the package imports none of them."""
