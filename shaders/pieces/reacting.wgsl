// Stands for a handle that there isn't.
const NONE: u32 = 0xffffffffu;

// Returns a field of the steps of cloth b at particle p of n, less what the reactions of its handles take back, given the component of
// the field: 0 in space, 1 and 2 along t1 and t2, 3 across. From the kernel's bindings y, handles and reactions, and parameter room.
fn reacted(b: u32, field: u32, component: u32, p: u32, n: u32) -> f32 {
    let first = (6u * b + field) * n;
    var sum = y[first + p];
    for (var k = b * params.room; k < (b + 1u) * params.room && handles[k] != NONE; k++) {
        sum -= reactions[(4u * k + component) * n + p] * y[first + handles[k]];
    }
    return sum;
}
