// Lets Unix sockets pose as hidraw nodes, so that the REAL hidapi (Debian's library, or the PyPI wheel's `hidraw`) runs
// without a kernel that has devices. Preload it, or link it in front of hidapi.
//
// Every folder $HIDSHIM/NAME is one device; NAME poses as /dev/NAME:
//     socket      AF_UNIX SEQPACKET, listening: each open() of the node is a connection; a datagram is a report
//     ids         "BUS VENDOR PRODUCT INTERFACE" in hexadecimal, e.g. 3 1209 1 0
//     product, serial, manufacturer   one line each, may be missing
//     descriptor  the HID report descriptor, binary; without it: one vendor collection FF00/1 of 64 bytes, no ids
//     errno       if there: what open() fails with
// What the virtual device does with its sockets is its own business: not reading makes writes block, shutting down is
// being unplugged, removing the folder takes it off the list.
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/hidraw.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <sys/un.h>
#include <unistd.h>

#define MOST_DEVICES 16
#define MOST_FILES 4096

static const char *folder(void) { return getenv("HIDSHIM"); }

// Which device a descriptor is of: 0 none, else its hidraw number + 1.
static unsigned char of_file[MOST_FILES];

static int read_file(const char *name, const char *file, void *out, size_t size) {
    static int (*real_open)(const char *, int, ...);
    if (!real_open) real_open = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, "open");
    char path[512];
    snprintf(path, sizeof path, "%s/%s/%s", folder(), name, file);
    const int fd = real_open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return -1;
    const ssize_t n = read(fd, out, size);
    close(fd);
    return (int)n;
}

static const char *text_of(const char *name, const char *file, char *out, size_t size) {
    const int n = read_file(name, file, out, size - 1);
    if (n < 0) return NULL;
    out[n] = 0;
    out[strcspn(out, "\n")] = 0;
    return out;
}

static void ids_of(const char *name, unsigned ids[4]) {
    char text[64];
    ids[0] = 3, ids[1] = 0x1209, ids[2] = 1, ids[3] = 0;
    if (text_of(name, "ids", text, sizeof text)) sscanf(text, "%x %x %x %x", &ids[0], &ids[1], &ids[2], &ids[3]);
}

static int descriptor_of(const char *name, unsigned char *out, size_t size) {
    static const unsigned char plain[] = {0x06, 0x00, 0xFF, 0x09, 0x01, 0xA1, 0x01, 0x15, 0x00, 0x26, 0xFF, 0x00, 0x75, 0x08,
                                          0x95, 0x40, 0x09, 0x02, 0x81, 0x02, 0x95, 0x40, 0x09, 0x03, 0x91, 0x02, 0xC0};
    const int n = read_file(name, "descriptor", out, size);
    if (n > 0) return n;
    memcpy(out, plain, sizeof plain);
    return (int)sizeof plain;
}

// ---- the node ------------------------------------------------------------------------------------------------

// "hidraw3" of "/dev/hidraw3", if a folder says that it is one of ours.
static const char *device_of(const char *path) {
    if (!folder() || !path || strncmp(path, "/dev/hidraw", 11) != 0) return NULL;
    char place[512];
    struct stat status;
    snprintf(place, sizeof place, "%s/%s", folder(), path + 5);
    return stat(place, &status) == 0 ? path + 5 : NULL;
}

static int connect_to(const char *name, int flags) {
    char text[16];
    if (text_of(name, "errno", text, sizeof text)) {
        errno = atoi(text);
        return -1;
    }
    const int fd = socket(AF_UNIX, SOCK_SEQPACKET | (flags & O_CLOEXEC ? SOCK_CLOEXEC : 0), 0);
    if (fd < 0) return -1;
    const int few = 1;  // a hidraw write waits for the device: as few reports as possible may queue up
    setsockopt(fd, SOL_SOCKET, SO_SNDBUF, &few, sizeof few);
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    snprintf(address.sun_path, sizeof address.sun_path, "%s/%s/socket", folder(), name);
    if (connect(fd, (struct sockaddr *)&address, sizeof address) != 0 || fd >= MOST_FILES) {
        close(fd);
        errno = ENODEV;
        return -1;
    }
    if (flags & O_NONBLOCK) fcntl(fd, F_SETFL, O_NONBLOCK);
    of_file[fd] = (unsigned char)(atoi(name + 6) + 1);
    return fd;
}

// hidapi reads usages from /sys/class/hidraw/hidraw0/device/report_descriptor.
static int open_descriptor(const char *path) {
    char name[16] = "";
    if (!folder() || !path || sscanf(path, "/sys/class/hidraw/%15[^/]/device/report_descriptor", name) != 1) return -1;
    unsigned char descriptor[HID_MAX_DESCRIPTOR_SIZE];
    const int size = descriptor_of(name, descriptor, sizeof descriptor);
    const int fd = memfd_create("report_descriptor", MFD_CLOEXEC);
    if (fd < 0 || write(fd, descriptor, (size_t)size) != size) return fd;
    lseek(fd, 0, SEEK_SET);
    return fd;
}

#define OPEN(name)                                                                            \
    int name(const char *path, int flags, ...) {                                              \
        static int (*real)(const char *, int, ...);                                           \
        if (!real) real = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, #name);           \
        va_list list;                                                                         \
        va_start(list, flags);                                                                \
        const int mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(list, int) : 0;             \
        va_end(list);                                                                         \
        const int descriptor = open_descriptor(path);                                         \
        if (descriptor >= 0) return descriptor;                                               \
        const char *device = device_of(path);                                                 \
        return device ? connect_to(device, flags) : real(path, flags, mode);                  \
    }
OPEN(open)
OPEN(open64)

int close(int fd) {
    static int (*real)(int);
    if (!real) real = (int (*)(int))dlsym(RTLD_NEXT, "close");
    if (fd >= 0 && fd < MOST_FILES) of_file[fd] = 0;
    return real(fd);
}

int ioctl(int fd, unsigned long request, ...) {
    static int (*real)(int, unsigned long, ...);
    if (!real) real = (int (*)(int, unsigned long, ...))dlsym(RTLD_NEXT, "ioctl");
    va_list list;
    va_start(list, request);
    void *argument = va_arg(list, void *);
    va_end(list);
    if (fd < 0 || fd >= MOST_FILES || of_file[fd] == 0) return real(fd, request, argument);
    char name[16];
    snprintf(name, sizeof name, "hidraw%d", of_file[fd] - 1);
    unsigned char descriptor[HID_MAX_DESCRIPTOR_SIZE];
    const int size = descriptor_of(name, descriptor, sizeof descriptor);
    if (request == HIDIOCGRDESCSIZE) {
        *(int *)argument = size;
        return 0;
    }
    if (request == HIDIOCGRDESC) {
        struct hidraw_report_descriptor *out = argument;
        memcpy(out->value, descriptor, (size_t)size < out->size ? (size_t)size : out->size);
        return 0;
    }
    if (request == HIDIOCGRAWINFO) {
        unsigned ids[4];
        ids_of(name, ids);
        struct hidraw_devinfo *out = argument;
        out->bustype = ids[0], out->vendor = (short)ids[1], out->product = (short)ids[2];
        return 0;
    }
    errno = ENOTTY;
    return -1;
}

// fstat of a node says which character device it is: hidapi looks its strings up by that.
static int as_node(int fd, struct stat *out, int result) {
    if (result == 0 && fd >= 0 && fd < MOST_FILES && of_file[fd] != 0) {
        out->st_mode = S_IFCHR | 0600;
        out->st_rdev = makedev(240, of_file[fd] - 1u);
    }
    return result;
}

int fstat(int fd, struct stat *out) {
    static int (*real)(int, struct stat *);
    if (!real) real = (int (*)(int, struct stat *))dlsym(RTLD_NEXT, "fstat");
    return as_node(fd, out, real(fd, out));
}

// What fstat was called before glibc 2.33; the wheel is built for that.
int __fxstat(int version, int fd, struct stat *out) {
    static int (*real)(int, int, struct stat *);
    if (!real) real = (int (*)(int, int, struct stat *))dlsym(RTLD_NEXT, "__fxstat");
    return as_node(fd, out, real(version, fd, out));
}

// ---- the list: the few calls of libudev that hidapi makes --------------------------------------------------------

struct udev_list_entry {
    char name[64];
    struct udev_list_entry *next;
};
enum kind { NODE, HID, INTERFACE, USB };
struct udev_device {
    char name[16];
    char text[6][512];
    struct udev_device *parent[4];
    enum kind kind;
    int references;
};
struct udev_enumerate {
    struct udev_list_entry entries[MOST_DEVICES];
    int count;
};

static struct udev_device *device_new(const char *name) {
    struct udev_device *device = calloc(1, sizeof *device);
    snprintf(device->name, sizeof device->name, "%.15s", name);
    device->references = 1;
    return device;
}

void *udev_new(void) { return calloc(1, 8); }
void *udev_unref(void *udev) {
    free(udev);
    return NULL;
}
struct udev_enumerate *udev_enumerate_new(void *udev) {
    (void)udev;
    return calloc(1, sizeof(struct udev_enumerate));
}
int udev_enumerate_add_match_subsystem(struct udev_enumerate *list, const char *subsystem) {
    (void)list, (void)subsystem;
    return 0;
}
int udev_enumerate_scan_devices(struct udev_enumerate *list) {
    struct dirent **found = NULL;
    const int n = folder() ? scandir(folder(), &found, NULL, alphasort) : 0;
    for (int i = 0; i < n; ++i) {
        if (strncmp(found[i]->d_name, "hidraw", 6) == 0 && list->count < MOST_DEVICES) {
            struct udev_list_entry *entry = &list->entries[list->count++];
            snprintf(entry->name, sizeof entry->name, "/sys/class/hidraw/%.15s", found[i]->d_name);
            if (list->count > 1) entry[-1].next = entry;
        }
        free(found[i]);
    }
    free(found);
    return 0;
}
struct udev_list_entry *udev_enumerate_get_list_entry(struct udev_enumerate *list) {
    return list->count ? list->entries : NULL;
}
void *udev_enumerate_unref(struct udev_enumerate *list) {
    free(list);
    return NULL;
}
struct udev_list_entry *udev_list_entry_get_next(struct udev_list_entry *entry) { return entry->next; }
const char *udev_list_entry_get_name(struct udev_list_entry *entry) { return entry->name; }

struct udev_device *udev_device_new_from_syspath(void *udev, const char *path) {
    (void)udev;
    const char *name = strrchr(path, '/');
    return device_new(name ? name + 1 : path);
}
struct udev_device *udev_device_new_from_devnum(void *udev, char type, dev_t number) {
    (void)udev, (void)type;
    char name[16];
    snprintf(name, sizeof name, "hidraw%u", minor(number));
    return device_new(name);
}
struct udev_device *udev_device_unref(struct udev_device *device) {
    if (!device || --device->references > 0) return NULL;
    for (int i = 0; i < 4; ++i) free(device->parent[i]);
    free(device);
    return NULL;
}
const char *udev_device_get_devnode(struct udev_device *device) {
    snprintf(device->text[0], sizeof device->text[0], "/dev/%s", device->name);
    return device->text[0];
}
const char *udev_device_get_syspath(struct udev_device *device) {
    snprintf(device->text[1], sizeof device->text[1], "/sys/class/hidraw/%s", device->name);
    return device->text[1];
}
// Parents belong to their child, as in libudev.
struct udev_device *udev_device_get_parent_with_subsystem_devtype(struct udev_device *device, const char *subsystem,
                                                                  const char *type) {
    const enum kind kind = strcmp(subsystem, "hid") == 0          ? HID
                           : type && strcmp(type, "usb_interface") == 0 ? INTERFACE
                                                                        : USB;
    if (!device->parent[kind]) {
        device->parent[kind] = device_new(device->name);
        device->parent[kind]->kind = kind;
    }
    return device->parent[kind];
}
const char *udev_device_get_sysattr_value(struct udev_device *device, const char *attribute) {
    char text[128];
    unsigned ids[4];
    ids_of(device->name, ids);
    char *out = device->text[5];
    if (device->kind == HID && strcmp(attribute, "uevent") == 0) {
        const char *serial = text_of(device->name, "serial", text, sizeof text);
        const int n = snprintf(out, 512, "DRIVER=hid-generic\nHID_ID=%04X:%08X:%08X\nHID_UNIQ=%s\n", ids[0], ids[1], ids[2],
                               serial ? serial : "");
        const char *product = text_of(device->name, "product", text, sizeof text);
        snprintf(out + n, (size_t)(512 - n), "HID_NAME=%s\n", product ? product : "");
        return out;
    }
    if (strcmp(attribute, "bInterfaceNumber") == 0) {
        snprintf(out, 512, "%02x", ids[3]);
        return out;
    }
    if (strcmp(attribute, "bcdDevice") == 0) return "0100";
    if (strcmp(attribute, "manufacturer") == 0 || strcmp(attribute, "product") == 0 || strcmp(attribute, "serial") == 0) {
        return text_of(device->name, attribute, out, 512);
    }
    return NULL;
}
