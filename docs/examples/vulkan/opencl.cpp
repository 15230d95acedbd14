#include "opencl.h"

#include <chrono>
#include <cstring>
#include <stdexcept>

namespace {

// Of OpenCL 3.0 and its extensions cl_khr_device_uuid and cl_khr_external_memory; gffe.h asks for OpenCL 1.2 only.
constexpr cl_device_info DEVICE_UUID = 0x106A;
constexpr intptr_t OPAQUE_FD = 0x2060;
// Of cl_khr_semaphore and cl_khr_external_semaphore.
constexpr cl_ulong SEMAPHORE_TYPE = 0x203D, BINARY = 1, SEMAPHORE_OPAQUE_FD = 0x2055;
using Create = cl_mem(CL_API_CALL *)(cl_context, const intptr_t *, cl_mem_flags, size_t, void *, cl_int *);

template <typename Call> Call function(cl_platform_id platform, const char *name) {
    return reinterpret_cast<Call>(clGetExtensionFunctionAddressForPlatform(platform, name));
}

}  // namespace

#ifdef __linux__
#include <dlfcn.h>
static Create creator(cl_platform_id) {  // not an extension's, so the loader has it
    return reinterpret_cast<Create>(dlsym(RTLD_DEFAULT, "clCreateBufferWithProperties"));
}
#else
static Create creator(cl_platform_id platform) { return function<Create>(platform, "clCreateBufferWithProperties"); }
#endif

void Generator::check(cl_int error, const char *call) const {
    if (error != CL_SUCCESS) throw std::runtime_error(std::string(call) + ": OpenCL error " + std::to_string(error));
}

void Generator::check(gffe_status status) const {
    if (status) throw std::runtime_error(std::string("gffe: ") + gffe_message(gffe_));
}

Generator::Generator(const std::string &wanted) {
    cl_uint count = 0;
    cl_platform_id platforms[16];
    if (clGetPlatformIDs(16, platforms, &count) != CL_SUCCESS) count = 0;
    for (cl_uint k = 0; k < count && k < 16 && !can_share_; ++k) {
        char name[256] = "", extensions[8192] = "";
        cl_device_id device;
        clGetPlatformInfo(platforms[k], CL_PLATFORM_NAME, sizeof name - 1, name, nullptr);
        if (!std::strstr(name, wanted.c_str())) continue;
        if (clGetDeviceIDs(platforms[k], CL_DEVICE_TYPE_ALL, 1, &device, nullptr) != CL_SUCCESS) continue;
        clGetDeviceInfo(device, CL_DEVICE_EXTENSIONS, sizeof extensions - 1, extensions, nullptr);
        const bool shares = std::strstr(extensions, "cl_khr_external_memory_opaque_fd")
                            && !clGetDeviceInfo(device, DEVICE_UUID, uuid_.size(), uuid_.data(), nullptr);
        if (device_ && !shares) continue;
        platform_ = platforms[k];
        device_ = device;
        can_share_ = shares;
        can_signal_ = shares && std::strstr(extensions, "cl_khr_external_semaphore_opaque_fd");
        name_ = name;
    }
    if (!device_) throw std::runtime_error("OpenCL: there is no platform '" + wanted + "' with a device");
    cl_int error;
    context_ = clCreateContext(nullptr, 1, &device_, nullptr, nullptr, &error);
    check(error, "clCreateContext");
    queue_ = clCreateCommandQueue(context_, device_, 0, &error);
    check(error, "clCreateCommandQueue");
    acquire_ = function<Exchange>(platform_, "clEnqueueAcquireExternalMemObjectsKHR");
    release_ = function<Exchange>(platform_, "clEnqueueReleaseExternalMemObjectsKHR");
    can_share_ = can_share_ && acquire_ && release_ && creator(platform_);
    wait_ = function<Switch>(platform_, "clEnqueueWaitSemaphoresKHR");
    signal_ = function<Switch>(platform_, "clEnqueueSignalSemaphoresKHR");
    can_signal_ = can_signal_ && can_share_ && wait_ && signal_;
}

void Generator::open(int width, int height) {
    const gffe_options options = gffe_default_options(width, height);
    check(gffe_create(context_, queue_, &options, &gffe_));
}

cl_mem Generator::take(Buffer &buffer) {
    cl_int error;
    cl_mem made;
    if (buffer.is_shared) {
        const intptr_t properties[] = {OPAQUE_FD, buffer.descriptor, 0};
        made = creator(platform_)(context_, properties, CL_MEM_READ_WRITE, buffer.size, nullptr, &error);
        buffer.descriptor = -1;  // OpenCL's now
    } else {
        made = clCreateBuffer(context_, CL_MEM_READ_WRITE, buffer.size, nullptr, &error);
    }
    check(error, "clCreateBuffer");
    taken_.push_back(made);
    return made;
}

bool Generator::take(const std::array<int, 2> &semaphores) {
    using Make = Semaphore(CL_API_CALL *)(cl_context, const cl_ulong *, cl_int *);
    const auto make = function<Make>(platform_, "clCreateSemaphoreWithPropertiesKHR");
    if (semaphores[0] < 0) return false;
    check(make ? CL_SUCCESS : CL_INVALID_OPERATION, "clCreateSemaphoreWithPropertiesKHR");
    for (int k = 0; k < 2; ++k) {
        const cl_ulong properties[] = {SEMAPHORE_TYPE, BINARY, SEMAPHORE_OPAQUE_FD, cl_ulong(semaphores[k]), 0};
        cl_int error;
        (k ? shown_ : rendered_) = make(context_, properties, &error);
        check(error, "clCreateSemaphoreWithPropertiesKHR");
    }
    return true;
}

void Generator::exchange(Exchange call, const std::vector<cl_mem> &memory, cl_event *done) {
    const auto start = std::chrono::steady_clock::now();
    check(call(queue_, static_cast<cl_uint>(memory.size()), memory.data(), 0, nullptr, done), "external memory");
    const std::chrono::duration<double, std::milli> spent = std::chrono::steady_clock::now() - start;
    shared_milliseconds_ += spent.count();
}

void Generator::submit(const Planes &planes, const std::array<cl_mem, 3> &memory, const gffe_camera &camera,
                       double time, bool reset) {
    for (int k = 0; k < 3 && !planes[k].is_shared; ++k)
        check(
            clEnqueueWriteBuffer(queue_, memory[k], CL_FALSE, 0, planes[k].size, planes[k].mapped, 0, nullptr, nullptr),
            "clEnqueueWriteBuffer");
    if (rendered_) check(wait_(queue_, 1, &rendered_, nullptr, 0, nullptr, nullptr), "clEnqueueWaitSemaphoresKHR");
    if (planes[0].is_shared) exchange(acquire_, {memory.begin(), memory.end()}, nullptr);  // in order, so no event
    check(gffe_submit(gffe_, memory[0], memory[1], memory[2], &camera, nullptr, time, reset));
    if (!planes[0].is_shared) return;  // `make` waits before Vulkan may write to the mapped memory again
    // The frame before the last one is no longer read: gffe uses two, and Vulkan renders into the third.
    in_use_.insert(in_use_.end(), memory.begin(), memory.end());
    if (in_use_.size() <= 6) return;
    exchange(release_, {in_use_.begin(), in_use_.begin() + 3}, nullptr);
    in_use_.erase(in_use_.begin(), in_use_.begin() + 3);
}

void Generator::make(const gffe_camera &camera, double time, Buffer &shown, cl_mem memory) {
    gffe_frame made;
    check(gffe_extrapolate(gffe_, &camera, time, &made));
    if (!shown.is_shared) {
        ++waits_;
        check(clEnqueueReadBuffer(queue_, made.color, CL_TRUE, 0, shown.size, shown.mapped, 0, nullptr, nullptr),
              "clEnqueueReadBuffer");
        return;
    }
    exchange(acquire_, {memory}, nullptr);
    check(clEnqueueCopyBuffer(queue_, made.color, memory, 0, 0, shown.size, 0, nullptr, nullptr),
          "clEnqueueCopyBuffer");
    cl_event done = nullptr;
    exchange(release_, {memory}, shown_ ? nullptr : &done);
    if (shown_) {
        check(signal_(queue_, 1, &shown_, nullptr, 0, nullptr, nullptr), "clEnqueueSignalSemaphoresKHR");
        check(clFlush(queue_), "clFlush");
        return;
    }
    ++waits_;
    const cl_int error = clWaitForEvents(1, &done);  // Vulkan shows it next
    clReleaseEvent(done);
    check(error, "clWaitForEvents");
}

Generator::~Generator() {
    gffe_destroy(gffe_);
    if (!in_use_.empty()) release_(queue_, static_cast<cl_uint>(in_use_.size()), in_use_.data(), 0, nullptr, nullptr);
    if (queue_) clFinish(queue_);
    using Release = cl_int(CL_API_CALL *)(Semaphore);
    for (Semaphore one : {rendered_, shown_})
        if (one) function<Release>(platform_, "clReleaseSemaphoreKHR")(one);
    for (cl_mem one : taken_) clReleaseMemObject(one);
    if (queue_) clReleaseCommandQueue(queue_);
    if (context_) clReleaseContext(context_);
}
