
// Returns the corners of a triangle: two to each cell, in the order of `Grid::faces`.
fn corners_of(face: u32, columns: u32) -> vec3u {
    let cell = face / 2u;
    let a = cell / (columns - 1u) * columns + cell % (columns - 1u);
    let c = a + columns + 1u;
    return select(vec3u(a, c, a + 1u), vec3u(a, a + columns, c), face % 2u == 0u);
}

// Returns the index of the first triangle of the cell behind a particle, which is not on the far borders.
fn first_face_of(p: u32, columns: u32) -> u32 {
    return 2u * (p / columns * (columns - 1u) + p % columns);
}

// Returns the particle at which the cell of the triangle across a side of another begins, if there is one.
fn cell_across(face: u32, side: u32, columns: u32) -> u32 {
    let cell = face / 2u;
    let a = cell / (columns - 1u) * columns + cell % (columns - 1u);
    switch 3u * (face % 2u) + side {
        case 0u: {
            return a - 1u;
        }
        case 1u: {
            return a + columns;
        }
        case 4u: {
            return a + 1u;
        }
        case 5u: {
            return a - columns;
        }
        default: {
            return a;
        }
    }
}

const NO_CORNER: u32 = 0xffffffffu;

// Returns the corner of the triangle across a side of another, which leads from its corner `side` to the next; NO_CORNER
// on the border.
fn corner_across(face: u32, side: u32, rows: u32, columns: u32) -> u32 {
    let cell = face / 2u;
    let i = cell / (columns - 1u);
    let j = cell % (columns - 1u);
    let a = i * columns + j;
    switch 3u * (face % 2u) + side {
        case 0u: {
            return select(NO_CORNER, a - 1u, j > 0u);
        }
        case 1u: {
            return select(NO_CORNER, a + 2u * columns + 1u, i + 2u < rows);
        }
        case 2u: {
            return a + 1u;
        }
        case 3u: {
            return a + columns;
        }
        case 4u: {
            return select(NO_CORNER, a + columns + 2u, j + 2u < columns);
        }
        default: {
            return select(NO_CORNER, a - columns, i > 0u);
        }
    }
}
