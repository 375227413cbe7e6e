"""What NVIDIA's assembler says of a kernel, from its SPIR-V, on a machine without its hardware.

NVIDIA's driver compiles SPIR-V itself. Here it becomes HLSL (spirv-cross), CUDA (slangc), PTX (nvrtc) and machine code
(ptxas): other front ends before the same registers and the same assembler, so its figures are near those of the driver,
not equal to them. Needs Debian's spirv-cross and, without their dependencies, four packages of PyPI:

    pip install --no-deps slangtorch nvidia-cuda-nvcc-cu12 nvidia-cuda-nvrtc-cu12 nvidia-cuda-runtime-cu12
"""

import ctypes
import hashlib
import importlib.metadata
import math
import pathlib
import re
import struct
import subprocess
import tempfile

# Registers of a scheduler, and of a multiprocessor its schedulers, blocks and bytes of shared memory.
FAMILIES = {
    "sm_75": (16384, 4, 16, 64 << 10),
    "sm_89": (16384, 4, 24, 100 << 10),
    "sm_90": (16384, 4, 32, 228 << 10),
}
# Warps of a scheduler at most.
WARPS = {"sm_75": 8, "sm_89": 12, "sm_90": 16}
# Bytes of shared memory that the system takes of each block, where it does.
RESERVED = 1 << 10
# Kernels that differ in nothing are compiled once.
seen = {}


def file_of(package, path):
    """Returns a file of an installed package."""
    return pathlib.Path(importlib.metadata.distribution(package).locate_file(path))


def run(*command):
    """Returns what a command writes to stderr. Fails if it fails."""
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{command[0]}: {done.stderr or done.stdout}")
    return done.stderr


def ptx_of(cuda, family):
    """Returns the PTX of a CUDA source."""
    library = file_of("nvidia-cuda-nvrtc-cu12", "nvidia/cuda_nvrtc/lib/libnvrtc.so.12")
    nvrtc = ctypes.CDLL(str(library))
    program, size = ctypes.c_void_p(), ctypes.c_size_t()

    def text(kind):
        getattr(nvrtc, f"nvrtcGet{kind}Size")(program, ctypes.byref(size))
        buffer = ctypes.create_string_buffer(size.value)
        getattr(nvrtc, f"nvrtcGet{kind}")(program, buffer)
        return buffer.value

    headers = file_of("nvidia-cuda-runtime-cu12", "nvidia/cuda_runtime/include")
    options = [f"--gpu-architecture={family}", f"-I{headers}", "--std=c++17", "-DSLANG_CUDA_ENABLE_HALF=1"]
    options = (ctypes.c_char_p * len(options))(*[option.encode() for option in options])
    if nvrtc.nvrtcCreateProgram(ctypes.byref(program), cuda, b"kernel.cu", 0, None, None):
        raise RuntimeError("nvrtc: no program")
    try:
        if nvrtc.nvrtcCompileProgram(program, len(options), options):
            raise RuntimeError(f"nvrtc: {text('ProgramLog').decode()}")
        return text("PTX")
    finally:
        nvrtc.nvrtcDestroyProgram(ctypes.byref(program))


def with_parameters(hlsl):
    """Returns HLSL whose built-in values are parameters of their own: slangc does not take them in a structure for CUDA."""
    found = re.search(r"struct SPIRV_Cross_Input\n\{(.*?)\};", hlsl, re.DOTALL)
    if not found:
        return hlsl
    values = re.findall(r"(\w+) (\w+) : (\w+);", found[1])
    parameters = ", ".join(f"{kind} in_{name} : {meaning}" for kind, name, meaning in values)
    hlsl = hlsl.replace(found[0], "").replace("SPIRV_Cross_Input stage_input", parameters)
    return hlsl.replace("stage_input.", "in_")


def with_own_constants(hlsl):
    """Returns HLSL whose functions have the constants that they read: CUDA has no global ones with vectors."""
    constants = re.findall(r"^static const (\w+ (\w+)(?:\[\d+\])* = [^;]+;)\n", hlsl, re.MULTILINE)
    functions = re.split(r"(?m)^(?=\w+ \w+\([^;{]*\)\n\{\n)", hlsl)
    for constant, name in constants:
        functions = [text.replace(f"static const {constant}\n", "") for text in functions]
        reads = lambda text: re.search(rf"\b{name}\b", text)
        functions[1:] = [text.replace("\n{\n", f"\n{{\n    {constant}\n", 1) if reads(text) else text for text in functions[1:]]
    return "".join(functions)


def with_declared_results(hlsl):
    """Returns HLSL that declares what atomic stores return, which spirv-cross forgets."""
    exchange = re.compile(r"^( *)(\w+\.InterlockedExchange\(.*, (\w+)\);)$", re.MULTILINE)
    declared = lambda name: re.search(rf"\buint {name};", hlsl)
    return exchange.sub(lambda found: found[0] if declared(found[3]) else f"{found[1]}uint {found[3]};\n{found[0]}", hlsl)


def code_bytes(cubin):
    """Returns the size of the machine code in an object file (ELF, 64 bits): of its sections with instructions."""
    (headers,) = struct.unpack_from("<Q", cubin, 40)
    size, count = struct.unpack_from("<HH", cubin, 58)
    sections = [struct.unpack_from("<IIQQQQ", cubin, headers + k * size) for k in range(count)]
    executable = 4
    return sum(section[5] for section in sections if section[2] & executable)


def warps(family, registers, shared, invocations):
    """Returns how many warps of workgroups of this size a scheduler holds at once."""
    of_scheduler, schedulers, blocks, memory = FAMILIES[family]
    of_block = math.ceil(invocations / 32)
    by_registers = of_scheduler // (32 * 8 * math.ceil(max(registers, 1) / 8)) * schedulers // of_block
    reserved = 0 if family == "sm_75" else RESERVED
    by_memory = memory // (shared + reserved) if shared + reserved else blocks
    by_warps = WARPS[family] * schedulers // of_block
    return min(blocks, by_registers, by_memory, by_warps) * of_block / schedulers


def statistics(spirv, family, workgroup):
    """Returns the statistics of a kernel under the names that Mesa gives them; the latency is unknown, and 0."""
    key = family, hashlib.sha256(spirv.read_bytes()).digest()
    if key not in seen:
        seen[key] = compiled(spirv, family, math.prod(workgroup))
    return seen[key]


def compiled(spirv, family, invocations):
    with tempfile.TemporaryDirectory() as folder:
        hlsl, cuda, ptx, cubin = [pathlib.Path(folder) / f"kernel.{end}" for end in ["hlsl", "cu", "ptx", "cubin"]]
        run("spirv-cross", spirv, "--hlsl", "--shader-model", "62", "--hlsl-enable-16bit-types", "--output", hlsl)
        hlsl.write_text(with_declared_results(with_own_constants(with_parameters(hlsl.read_text()))))
        slangc = file_of("slangtorch", "slangtorch/bin/slangc")
        run(slangc, hlsl, "-target", "cuda", "-entry", "main", "-stage", "compute", "-o", cuda)
        ptx.write_bytes(ptx_of(cuda.read_bytes(), family))
        ptxas = file_of("nvidia-cuda-nvcc-cu12", "nvidia/cuda_nvcc/bin/ptxas")
        said = run(ptxas, f"-arch={family}", "-v", "-O3", ptx, "-o", cubin)
        number = lambda pattern: int((re.search(rf"(\d+) {pattern}", said) or [0, 0])[1])
        registers, shared = number("registers"), number("bytes smem")
        return {
            "LDS size": shared,
            "VGPRs": registers,
            "Subgroups per SIMD": int(warps(family, registers, shared, invocations)),
            "Spilled VGPRs": number("bytes spill stores") // 4,
            "Spilled SGPRs": 0,
            "Scratch size": number("bytes stack frame"),
            "Instructions": code_bytes(cubin.read_bytes()) // 16,
            "Latency": 0,
        }
