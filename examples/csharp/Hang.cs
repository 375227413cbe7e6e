// A sheet that hangs from two corners, of which one is led upwards, through the C interface (docs/c.md). The shared library of
// fnopt must be where the system looks for libraries, as with LD_LIBRARY_PATH.

using System;
using System.Linq;
using System.Runtime.InteropServices;
// size_t, under the name that older compilers know, too, such as Mono's.
using Size = System.UIntPtr;

static class Fnopt
{
    [StructLayout(LayoutKind.Sequential)]
    public struct Options
    {
        [MarshalAs(UnmanagedType.LPUTF8Str)] public string Solver, Device, Adapter, Checkpoint;
        public Size Iterations;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct Control
    {
        public IntPtr Handles;
        public Size HandleCount;
        public IntPtr Wind, Accelerations;
        public IntPtr Bodies;
        public Size BodyCount;
    }

    const string Library = "fnopt";

    [DllImport(Library)] static extern IntPtr fnopt_last_error();
    [DllImport(Library)] public static extern int fnopt_scene_parse(
        [MarshalAs(UnmanagedType.LPUTF8Str)] string json, [MarshalAs(UnmanagedType.LPUTF8Str)] string folder, out IntPtr scene);
    [DllImport(Library)] public static extern void fnopt_scene_free(IntPtr scene);
    [DllImport(Library)] public static extern int fnopt_simulation_new(
        IntPtr[] scenes, Size cloths, ref Options options, out IntPtr simulation);
    [DllImport(Library)] public static extern void fnopt_simulation_free(IntPtr simulation);
    [DllImport(Library)] public static extern int fnopt_step(IntPtr simulation, ref Control control);
    [DllImport(Library)] public static extern int fnopt_positions(IntPtr simulation, [Out] float[] buffer, Size count);
    [DllImport(Library)] public static extern Size fnopt_handles(IntPtr simulation, [Out] uint[] buffer, Size count);
    [DllImport(Library)] public static extern Size fnopt_particles(IntPtr simulation);

    public static void Check(int status)
    {
        if (status != 0) throw new InvalidOperationException(Marshal.PtrToStringUTF8(fnopt_last_error()));
    }
}

static class Hang
{
    static void Main()
    {
        Fnopt.Check(Fnopt.fnopt_scene_parse("{\"grid\": [32, 32], \"motion\": \"none\"}", null, out var scene));
        var options = new Fnopt.Options { Solver = "spectral", Device = "cpu" };
        Fnopt.Check(Fnopt.fnopt_simulation_new(new[] { scene }, (Size)1, ref options, out var simulation));
        Fnopt.fnopt_scene_free(scene);

        var positions = new float[3 * (uint)Fnopt.fnopt_particles(simulation)];
        var held = new uint[2];
        Fnopt.fnopt_handles(simulation, held, (Size)2);
        Fnopt.Check(Fnopt.fnopt_positions(simulation, positions, (Size)positions.Length));
        var targets = held.SelectMany(p => new[] { 0, 1, 2 }.Select(c => (double)positions[3 * p + c])).ToArray();
        var top = targets[1];

        // The library reads the targets where they are.
        var pinned = GCHandle.Alloc(targets, GCHandleType.Pinned);
        var control = new Fnopt.Control { Handles = pinned.AddrOfPinnedObject(), HandleCount = (Size)2 };
        for (var frame = 1; frame <= 60; ++frame)
        {
            targets[1] = top + 0.2 * frame / 60.0;
            Fnopt.Check(Fnopt.fnopt_step(simulation, ref control));
        }
        pinned.Free();

        Fnopt.Check(Fnopt.fnopt_positions(simulation, positions, (Size)positions.Length));
        var lowest = positions.Where((_, k) => k % 3 == 1).Min();
        Console.WriteLine($"lowest point {lowest:F3} m, led corner at {positions[3 * held[0] + 1]:F3} m");
        Fnopt.fnopt_simulation_free(simulation);
    }
}
